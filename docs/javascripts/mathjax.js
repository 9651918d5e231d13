// Equations are typeset in the browser by a copy of MathJax that lies beside this file
// (docs/hooks.py puts it there): the full one, which asks for no extension at run time. In pages arithmatex has marked them; in notebooks they
// stand between dollars in the cells of text.
const inNotebook = document.querySelector(".jp-MarkdownOutput") !== null;

window.MathJax = {
  tex: {
    packages: { "[-]": ["noundefined"] }, // an unknown command is an error, not red text
    inlineMath: inNotebook ? [["$", "$"]] : [["\\(", "\\)"]],
    displayMath: inNotebook ? [["$$", "$$"]] : [["\\[", "\\]"]],
    processEscapes: true,
    processEnvironments: true,
  },
  options: {
    ignoreHtmlClass: inNotebook ? "jp-CodeCell|md-(header|tabs|sidebar|footer)" : ".*|",
    processHtmlClass: "arithmatex",
    enableMenu: false, // its entries would fetch more files
  },
  svg: { displayAlign: "left", displayIndent: "1.5em", scale: 0.95 },
};
