// Equations are typeset in the browser by a copy of MathJax that lies beside this file
// (docs/hooks.py puts it there): in pages by arithmatex, in notebooks by their dollars.
window.MathJax = {
  tex: {
    inlineMath: [["\\(", "\\)"], ["$", "$"]],
    displayMath: [["\\[", "\\]"], ["$$", "$$"]],
    processEscapes: true,
    processEnvironments: true,
  },
  options: {
    ignoreHtmlClass: ".*|",
    processHtmlClass: "arithmatex|jp-MarkdownOutput",
    enableMenu: false, // its entries would fetch more files
  },
  svg: { displayAlign: "left", displayIndent: "1.5em", scale: 0.95 },
};
