"""axe-core in a page: what is wrong with what is shown."""

import os
from pathlib import Path

from app.browser import Page

ROOT = Path(__file__).resolve().parents[3]
AXE = Path(os.environ.get("DOUSA_AXE", ROOT / "build" / "node_modules" / "axe-core" / "axe.min.js"))

_RUN = """
const done = arguments[arguments.length - 1];
const say = (rule, node) => `${rule.id}: ${node.html.slice(0, 160)} ${node.failureSummary.split('\\n')[1]}`;
axe.run(document, { resultTypes: ['violations'] }).then(
  (found) => done({
    passed: found.passes.length,
    wrong: found.violations.flatMap((rule) => rule.nodes.map((node) => say(rule, node))),
  }),
  (error) => done({ passed: 0, wrong: [String(error)] }),
);
"""


def find_faults(page: Page) -> list[str]:
    """What axe-core finds wrong with what a page shows; it must have found something right too."""
    page.settle()
    if not page.run("return Boolean(window.axe)"):
        page.run(AXE.read_text(encoding="utf-8"))
    found = page.driver.execute_async_script(_RUN)
    assert found["wrong"] or found["passed"] > 10
    wrong: list[str] = found["wrong"]
    return wrong
