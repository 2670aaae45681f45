import json
import re

from porse.config import load_params
from porse.search.schedule import allowed_epochs


def test_the_committed_metrics_are_those_of_the_readme(root):
    metrics, page = json.loads((root / "metrics.json").read_text()), (root / "README.md").read_text()
    assert f"| all | {metrics['score']:.3f} | **{metrics['mts']:.3f}** | | |" in page
    assert f"**{metrics['success']:.3f} (" in page


def test_the_default_run_learns_to_hover(root):
    metrics = json.loads((root / "metrics.json").read_text())
    assert metrics["mts"] > -0.25


def test_the_default_run_spent_what_its_schedule_allows(root):
    metrics = json.loads((root / "metrics.json").read_text())
    assert metrics["epochs_spent"] <= allowed_epochs(load_params(root / "params.yaml"))


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
