"""Opens every page of a built site in a browser; `make docs` and `docs-check` call it.

    python docs/browser.py site

A page must typeset as many equations as it has, none in error, load every picture,
leave no error on the console, ask nothing of another host and be no wider than a phone.
Where no Chromium is installed, it says so and does nothing.
"""

from __future__ import annotations

import os
import shutil
import sys
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

from playwright.sync_api import Error, Page, sync_playwright

PHONE = {"width": 390, "height": 844}  # [px]

#: The longest wait for one page's equations [ms]
PATIENCE = 60_000

#: Of the file as written: equations that arithmatex marked, and in notebooks those
#: between dollars
COUNT = r"""(html) => {
  const written = new DOMParser().parseFromString(html, "text/html");
  let text = "";
  for (const cell of written.querySelectorAll(".jp-MarkdownOutput")) {
    cell.querySelectorAll("code, pre").forEach((code) => code.remove());
    text += cell.textContent + "\n\n";
  }
  const dollars = text.match(/\$\$[^$]+\$\$|\$[^$]+\$/g) || [];
  return written.querySelectorAll(".arithmatex").length + dollars.length;
}"""

#: Lazy pictures are asked for here, not when a reader scrolls to them
LOAD = """async () => {
  const wait = window.MathJax?.startup?.promise;
  if (wait) await wait;
  const pictures = [...document.images];
  pictures.forEach((picture) => { picture.loading = "eager"; });
  await Promise.all(pictures.map((picture) => picture.decode().catch(() => {})));
}"""

JUDGE = """() => ({
  typeset: document.querySelectorAll("mjx-container").length,
  wrong: [...document.querySelectorAll("mjx-container [data-mjx-error]")].map(
    (node) => node.getAttribute("data-mjx-error")),
  pictures: [...document.images].filter((p) => !p.naturalWidth).map((p) => p.src),
  width: document.documentElement.scrollWidth,
})"""


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Requests are not printed."""


def faults(page: Page, path: Path, site: Path, host: str) -> list[str]:
    """What is wrong with one page that ``host`` serves, a line each."""
    found: list[str] = []
    page.on("console", lambda m: m.type == "error" and found.append(m.text))
    page.on("pageerror", lambda error: found.append(str(error)))
    own = (host, "data:", "blob:")
    page.on(
        "request",
        lambda r: r.url.startswith(own) or found.append(f"asked for {r.url}"),
    )
    page.on("requestfailed", lambda r: found.append(f"not loaded: {r.url}"))
    page.set_default_timeout(PATIENCE)
    try:
        page.goto(host + path.relative_to(site).as_posix(), wait_until="load")
        page.evaluate(LOAD)
        seen = page.evaluate(JUDGE)
        written = page.evaluate(COUNT, path.read_text(encoding="utf-8"))
    except Error as error:
        return [*found, error.message.splitlines()[0]]
    if seen["typeset"] != written:
        found.append(f"{seen['typeset']} of {written} equations are typeset")
    found += [f"equation: {reason}" for reason in seen["wrong"]]
    found += [f"picture not loaded: {source}" for source in seen["pictures"]]
    if seen["width"] > PHONE["width"]:
        found.append(f"{seen['width']} px wide, a phone has {PHONE['width']}")
    return found


def main(site: Path) -> int:
    """Open all pages of ``site``; the exit status."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        print("no chromium here: the pages were not opened in a browser")
        return 0
    site = site.resolve()
    pages = sorted(site.rglob("*.html"))
    if not pages:
        print(f"error: no page in {site}: build it first", file=sys.stderr)
        return 2
    bad = 0
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=site))
    Thread(target=server.serve_forever, daemon=True).start()
    host = f"http://127.0.0.1:{server.server_port}/"
    with sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=chromium,
            chromium_sandbox=os.geteuid() != 0,  # root has none
            args=["--disable-gpu", "--disable-quic", "--disable-component-update"],
        )
        for path in pages:
            page = browser.new_page(viewport=PHONE)
            for fault in faults(page, path, site, host):
                print(f"{path.relative_to(site)}: {fault}", file=sys.stderr)
                bad += 1
            page.close()
        browser.close()
    server.shutdown()
    print(f"{len(pages)} pages in {Path(chromium).name}: {bad} faults")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
