import json
import re

from porse.report.markdown import results_table


def test_the_results_table_is_the_runs_own(root):
    metrics = json.loads((root / "metrics.json").read_text())
    assert results_table(metrics) in (root / "README.md").read_text()


def test_the_default_run_learns_to_hover(root):
    metrics = json.loads((root / "metrics.json").read_text())
    assert metrics["mts"] > -0.25


def test_the_default_run_spent_what_its_schedule_allows(root):
    metrics = json.loads((root / "metrics.json").read_text())
    assert metrics["epochs_spent"] <= metrics["epochs_allowed"]


def test_ci_runs_what_the_readme_says(root):
    readme, ci = (root / "README.md").read_text(), (root / ".ci" / "run").read_text()
    targets = set(re.findall(r"^([a-z][a-z-]*):", (root / "Makefile").read_text(), re.MULTILINE))
    for text in (readme, ci):
        assert set(re.findall(r"make ([a-z-]+)", text)) <= targets
    assert "make test" in readme
    assert "make repro" in readme
    assert "make test" in ci


def test_links_in_the_documentation_lead_somewhere(root):
    for page in [root / "README.md", root / "CONTRIBUTING.md", *(root / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"
