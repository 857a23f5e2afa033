"""A report in a browser: its size, and the time until it is shown and its first figure is drawn.

    python benchmarks/report_load.py REPORT.html [--repeat 5]

The size is without the plotting library. Times are medians of several visits of a headless Chromium
at 1400 px, from the begin of the navigation: until everything is read (the load event), and until
the first figure in sight has its curves; and whether at 400 px anything is wider than the window.
"""

import argparse
import re
import shutil
import statistics
from pathlib import Path

from playwright.sync_api import sync_playwright

LOADED = "performance.getEntriesByType('navigation')[0].loadEventEnd"
LIBRARY = re.compile(r'<script type="application/gzip" id="plotly">.*?</script>', re.DOTALL)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("report", type=Path)
    parser.add_argument("--repeat", type=int, default=5, help="visits (default: 5)")
    args = parser.parse_args()
    text = args.report.read_text()
    without = len(LIBRARY.sub("", text).encode())
    print(f"{without / 1e6:.2f} MB, {len(text.encode()) / 1e6:.2f} MB with the plotting library")
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    loaded, drawn = [], []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for _ in range(args.repeat):
            page = browser.new_page(viewport={"width": 1400, "height": 2000})
            page.goto(args.report.absolute().as_uri())
            loaded.append(page.evaluate(LOADED))
            if "Plotly" in text:
                page.wait_for_function("document.querySelector('.plot .main-svg path.js-line')")
                drawn.append(page.evaluate("performance.now()"))
            page.close()
        page = browser.new_page(viewport={"width": 400, "height": 900})
        page.goto(args.report.absolute().as_uri())
        wide = page.evaluate("document.documentElement.scrollWidth")
        browser.close()
    print(f"read after {statistics.median(loaded) / 1e3:.2f} s")
    if drawn:
        print(f"first figure after {statistics.median(drawn) / 1e3:.2f} s")
    print(f"at 400 px the page is {wide} px wide")


if __name__ == "__main__":
    main()
