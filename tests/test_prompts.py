"""Whole prompts, held as they are sent. After a wanted change: `python tests/test_prompts.py` writes them anew."""

import dataclasses
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
GOLDEN = ROOT / "tests" / "prompts"
FEEDBACK = [
    {"series": name, "epoch": epoch, "value": value, "maximum": 2.0, "mean": 0.123456, "minimum": -1.0}
    for name in ("fitness", "component/near", "progress/distance", "episode_length")
    for epoch, value in ((1, -0.5), (90, 1234.56789))
]
RECORD = {
    "fitness": (0.25, -1.5, 2.0),
    "component/near": (0.5, 0.75, 0.625),
    "progress/distance": (3.0, 2.5, 2.25),
    "goal_size": (0.875, 1.0, 1.125),
    "bonus_size": (0.25, 0.125, 0.1),
    "bonus_share": (0.275, 0.124, 0.0885),
    "cells_visited": (0.04, 0.11, 0.12),
    "new_cells": (38.0, 71.0, 9.0),
    "bonus": (0.02, 0.03, 0.05),
    "episode_length": (80.0, 90.0, 100.0),
}
"""Series of three epochs, those among them that no record shows."""


def briefs():
    from porse.generation.about import about
    from porse.generation.conversations import Brief
    from porse.tasks import find_task

    task = find_task("Quadcopter")
    winner = {
        "reward_source": "def compute_reward(x):\n    return x, {}\n",
        "mapping_source": "def mapping_function(self):\n    pass\n",
    }
    environment = task.observation_source().strip()
    first = Brief(ROOT / "prompts", about(task), environment, True, False, None, [], {}, {}, [])
    return {"first": first, "refinement": dataclasses.replace(first, winner=winner, feedback=FEEDBACK)}


def bred_briefs(first):
    """Briefs in which the reward of slot 0 has one parent, and two."""
    from porse.search.breeding import Breeding

    sources = {name: {"reward_source": f"def compute_reward({name}):\n    return {name}, {{}}\n"} for name in "xy"}
    told = [{"candidate_id": name, **row} for name in "xy" for row in FEEDBACK]
    bred = dataclasses.replace(first, members=sources, member_feedback=told)
    plans = {"mutation": Breeding(0, 1, "mutation", ("y",)), "crossover": Breeding(0, 1, "crossover", ("x", "y"))}
    return {operator: dataclasses.replace(bred, breedings={0: plan}) for operator, plan in plans.items()}


def prompts():
    from porse.config import load_params
    from porse.functions.verdict import Verdict
    from porse.generation.conversations import conversation, repair
    from porse.generation.values import alpha_question, beta_question
    from porse.search.feedback import STAGED, WEIGHED, series_of, shown_series

    params = load_params(ROOT / "params.yaml", ROOT)
    found = {
        f"{kind}-{name}": conversation(brief, kind, 0)
        for name, brief in briefs().items()
        for kind in ("reward", "mapping")
    }
    first = briefs()["first"]
    found |= {f"reward-{name}": conversation(brief, "reward", 0) for name, brief in bred_briefs(first).items()}
    found["mapping-beyond-goal"] = conversation(dataclasses.replace(first, beyond_goal=True), "mapping", 0)
    without = dataclasses.replace(briefs()["refinement"], has_bonus=False)
    found["reward-refinement-without-bonus"] = conversation(without, "reward", 0)
    verdict = Verdict(False, "variable", "expected variables of the task, found velocity", 2, (), ())
    found["repair"] = repair(found["mapping-first"][1:], "def f(): ...", verdict, ROOT / "prompts")
    curves = [
        {"candidate_id": "a", "series": name, "epoch": epoch, "value": value}
        for name, values in RECORD.items()
        for epoch, value in enumerate(values, 1)
    ]
    survivor = {"beta": 1.3, "alpha": 0.8}
    found["beta"] = beta_question(survivor, shown_series(curves, "a", WEIGHED), first.about, params, ROOT / "prompts")
    human = dataclasses.replace(params, candidate=dataclasses.replace(params.candidate, goal="human"))
    # The human reward has no components.
    shown = [series for series in shown_series(curves, "a", WEIGHED) if not series.name.startswith("component/")]
    found["beta-human"] = beta_question(survivor, shown, first.about, human, ROOT / "prompts")
    found["alpha"] = alpha_question(survivor, series_of(FEEDBACK, STAGED), first.about, params, ROOT / "prompts")
    return found


def text(messages):
    return "".join(f"<<< {message.role} >>>\n{message.content}\n\n" for message in messages)


@pytest.mark.parametrize(
    "name",
    [
        "reward-first",
        "mapping-first",
        "reward-refinement",
        "mapping-refinement",
        "reward-refinement-without-bonus",
        "mapping-beyond-goal",
        "reward-mutation",
        "reward-crossover",
        "repair",
        "beta",
        "beta-human",
        "alpha",
    ],
)
def test_a_prompt_is_the_golden_text(name):
    assert text(prompts()[name]) == (GOLDEN / f"{name}.txt").read_text()


def test_every_golden_text_is_used():
    assert {path.stem for path in GOLDEN.glob("*.txt")} == set(prompts())


def test_an_ablation_changes_nothing_but_its_sentence():
    plain, beyond = ((GOLDEN / f"{name}.txt").read_text() for name in ("mapping-first", "mapping-beyond-goal"))
    added = [line for line in beyond.splitlines() if line not in plain.splitlines()]
    assert len(added) == 1
    assert "beyond" not in plain
    assert beyond.replace(f"{added[0]}\n", "") == plain
    with_bonus, without = ((GOLDEN / f"reward-refinement{name}.txt").read_text() for name in ("", "-without-bonus"))
    assert with_bonus.replace(", together with a bonus for exploration", "") == without


def test_every_question_says_where_an_episode_starts_when_it_ends_and_what_fitness_measures():
    from porse.tasks import find_task

    task = find_task("Quadcopter")
    said = [
        f"At the start of an episode, {task.STARTS}.",
        f"An episode ends after at most 499 steps; earlier {task.ENDS}.",
        f"Fitness, which policies are judged by (higher is better): {task.FITNESS}.",
    ]
    for name, messages in prompts().items():
        assert [text(messages).count(line) for line in said] == [1, 1, 1], name


def test_a_task_that_says_nothing_of_itself_is_told_with_its_time_limit():
    from porse.prompts import render

    nothing = {"description": "to balance", "starts": "", "ends": "", "fitness": "", "limit": 250}
    assert (
        render(ROOT / "prompts", "about", **nothing) == "The task: to balance\nAn episode ends after at most 250 steps."
    )


def test_the_beta_prompt_shows_how_strong_both_rewards_are_and_what_was_explored():
    said = text(prompts()["beta"])
    for line in (
        "The goal reward counts 0.7 and the bonus 1.3.",
        "goal_size = [0.875, 1, 1.125]",
        "bonus_size = [0.25, 0.125, 0.1]",
        "bonus_share = [0.275, 0.124, 0.0885]",
        "cells_visited = [0.04, 0.11, 0.12]",
        "new_cells = [38, 71, 9]",
        "progress/distance = [3, 2.5, 2.25]",
    ):
        assert line in said
    assert "episode_length" not in said
    assert "\nbonus = " not in said
    # Each is told what it is, in one line.
    for name in ("goal_size and bonus_size", "bonus_share", "cells_visited", "new_cells"):
        assert said.count(f"\n- {name}: ") == 1


def test_without_a_bonus_of_cells_the_beta_prompt_speaks_of_what_there_is(params):
    from porse.generation.values import beta_question
    from porse.search.feedback import Series

    hashed = dataclasses.replace(
        params, candidate=dataclasses.replace(params.candidate, bonus="simhash", goal="sparse")
    )
    record = [Series("fitness", (1, 2), (0.5, 0.25))]
    facts = briefs()["first"].about
    said = text(beta_question({"beta": 1.0}, record, facts, hashed, ROOT / "prompts"))
    assert "hashed into cells" in said
    assert "the fitness of each step" in said
    assert not any(word in said for word in ("progress", "component", "language model", "goal_size", "new_cells"))


def test_the_reward_prompt_says_that_the_scale_of_the_whole_is_free():
    [line] = [line for line in text(prompts()["reward-first"]).splitlines() if "scale" in line]
    assert "The scale of the whole reward is free" in line
    assert "how large its components are beside each other" in line
    # Once is enough: what is shown of a training is in the reward's own units.
    assert "is free" not in text(prompts()["mapping-first"])


def test_a_missing_fact_is_an_error(root):
    from porse.errors import PorseError
    from porse.prompts import render

    with pytest.raises(PorseError, match="contract"):
        render(root / "prompts", "reward-system")


@pytest.mark.parametrize(
    ("template", "found"),
    [
        ("{{ fact.__class__ }}", "access to attribute '__class__'"),
        ("{{ ''.__class__.__mro__[1].__subclasses__() }}", "unsafe"),
        ("{{ self.__init__.__globals__ }}", "unsafe"),
        ("{{ fact.append(1) }}", "unsafe"),
        ("{{ fact.pop }}", "unsafe"),
        ("{% for n in range(10 ** 9) %}{% endfor %}", "Range too big"),
        ("{% include '../secret.jinja' %}", "TemplateNotFound"),
        ("{% include '/etc/hostname' %}", "TemplateNotFound"),
        ("{{ 1 // 0 }}", "ZeroDivisionError"),
        ("{{ fact + 1 }}", "TypeError"),
        ("{% if %}", "TemplateSyntaxError"),
        (b"\xff", "UnicodeDecodeError"),
    ],
)
def test_a_template_reaches_its_facts_and_its_folder_and_nothing_else(tmp_path, template, found):
    from porse.errors import PorseError
    from porse.prompts import render

    (tmp_path / "secret.jinja").write_text("secret")
    (tmp_path / "prompts").mkdir()
    (tmp_path / "prompts" / "odd.jinja").write_bytes(template if isinstance(template, bytes) else template.encode())
    expected = (
        rf"expected the prompt odd in .* to render with fact, found: .*{re.escape(found)}.*; correct the template"
    )
    with pytest.raises(PorseError, match=expected):
        render(tmp_path / "prompts", "odd", fact=[1])


def test_prompts_say_what_the_paper_says():
    """Section A.6: each of its points stands in the prompt, in this project's words."""
    found = {name: text(messages) for name, messages in prompts().items()}
    points = {
        "reward-first": ["torch.exp", "temperature", "one for each transformed component", "device", "exact type", "only be variables", "dictionary"],
        "reward-refinement": ["wholly new function", "scale or temperature", "drop it", "far larger", "First go through the components"],
        "mapping-first": ["have two", "average", "True", "False", "helpers", "a name"],
        "mapping-refinement": ["wholly new function", "sensitive", "does not move at all", "divisible into stages", "leave it out"],
        "alpha": ["record of the last stage", "weighted sum", "alpha low", "alpha high", "slightly lower", "evenly over 0 to 1", "Give 5"],
        "beta": ["exploration bonus", "slightly less weight", "slightly more weight", "spread evenly", "[0, 2]", "Give 5"],
    }  # fmt: skip
    for name, words in points.items():
        assert [word for word in words if word not in found[name]] == [], name


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    GOLDEN.mkdir(exist_ok=True)
    for stem, messages in prompts().items():
        (GOLDEN / f"{stem}.txt").write_text(text(messages))
