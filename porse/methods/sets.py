"""What the methods and the ablations of the paper differ in: named sets of values that replace those of `params.yaml`.

The method's set is laid over `params.yaml`, then the ablation's. Where a set says nothing, `params.yaml` holds. A stage
sees nothing but the values, so that editing another set concerns no stage (`porse.inputs`).

An ablation takes one thing away and leaves the rest: the weight of the goal reward, the number of trainings, and when
what else varies. Where it removes what mutants vary, they differ by their random draws alone (`draw`).
"""

from typing import Any

Set = dict[str, dict[str, Any]]

METHODS: dict[str, Set] = {
    # The paper's method: params.yaml as it is.
    "porse": {},
    # Ma et al. 2024: rewards alone, every policy trained from scratch to the end; the one that reached the highest fitness
    # in any epoch is refined.
    "eureka": {
        "candidate": {"bonus": "none", "beta": 0.0, "scale": 1.0},
        "generate": {"elites": 0},
        "eliminate": {"keep": "all", "score": "max"},
        "mutate": {"mutants": 0},
        "fuse": {"policy": "random"},
    },
    # Huang et al. 2025: Eureka's rewards; each candidate's alpha is searched by short trainings, the best candidate of
    # the first rung is trained to the end, and the best reward so far is refined.
    "roska": {
        "candidate": {"bonus": "none", "beta": 0.0, "scale": 1.0},
        "generate": {"elites": 0},
        "probe": {"trainings": 14},
        "eliminate": {"keep": "one"},
        "mutate": {"mutants": 0},
        "fuse": {"incumbent": "best"},
    },
    # Tables 14 and 15: ROSKA with a bonus that knows nothing of the task, over the whole observation.
    "roska-ce": {
        "candidate": {"bonus": "simhash", "beta": 1.0, "scale": 2.0},
        "generate": {"elites": 0},
        "probe": {"trainings": 14},
        "eliminate": {"keep": "one"},
        "mutate": {"mutants": 0},
        "fuse": {"incumbent": "best"},
    },
    # Hazra et al. 2025 without people: rewards evolve on islands, by mutation and crossover; MTS is their fitness.
    "revolve-auto": {
        "candidate": {"bonus": "none", "beta": 0.0, "scale": 1.0},
        "generate": {"elites": 0, "parents": "islands"},
        "eliminate": {"keep": "all", "score": "max"},
        "mutate": {"mutants": 0},
        "fuse": {"policy": "random"},
    },
    # Sarukkai et al. 2024: mappings asked for once; the sparse reward, and a bonus over sums of bins, for all the budget.
    "llmcount": {
        "candidate": {"goal": "sparse", "beta": 1.0, "scale": 2.0},
        "exploration": {"discretiser": "sum"},
        "generate": {"iterations": "first"},
        "train": {"length": "lineage"},
        "eliminate": {"keep": "all"},
        "mutate": {"mutants": 0},
    },
    # Tang et al. 2017 inside PoRSE: cells by SimHash of the observation in place of the mapping.
    "simhash": {"candidate": {"bonus": "simhash"}},
    # The reward that people wrote for the task: one policy, trained for as many epochs as a winning lineage.
    "human": {
        "candidate": {"goal": "human", "bonus": "none", "beta": 0.0, "scale": 1.0},
        "generate": {"elites": 0, "iterations": "first"},
        "train": {"length": "lineage"},
        "eliminate": {"keep": "all"},
        "mutate": {"mutants": 0},
    },
    # The fitness as a reward: one policy, as long.
    "sparse": {
        "candidate": {"goal": "sparse", "bonus": "none", "beta": 0.0, "scale": 1.0},
        "generate": {"elites": 0, "iterations": "first"},
        "train": {"length": "lineage"},
        "eliminate": {"keep": "all"},
        "mutate": {"mutants": 0},
    },
    # The same two, the whole budget of a run in one policy.
    "human-budget": {
        "candidate": {"goal": "human", "bonus": "none", "beta": 0.0, "scale": 1.0},
        "generate": {"elites": 0, "iterations": "first"},
        "train": {"length": "budget"},
        "eliminate": {"keep": "all"},
        "mutate": {"mutants": 0},
    },
    "sparse-budget": {
        "candidate": {"goal": "sparse", "bonus": "none", "beta": 0.0, "scale": 1.0},
        "generate": {"elites": 0, "iterations": "first"},
        "train": {"length": "budget"},
        "eliminate": {"keep": "all"},
        "mutate": {"mutants": 0},
    },
}

ABLATIONS: dict[str, Set] = {
    "none": {},
    # Table 1: no generated goal reward. The sparse reward takes its place, as in LLMCount, the paper's bonus alone.
    "without-goal-reward": {"candidate": {"goal": "sparse"}},
    # Table 1: no exploration bonus. The goal reward keeps its weight, scale - beta, and there is no beta to mutate.
    "without-bonus": {"candidate": {"bonus": "none"}, "mutate": {"vary": ["draw", "alpha"]}},
    # The bonus as eq. 3 has it to the letter: an absolute lambda, beside a goal reward in whatever units it has.
    "literal-bonus": {"exploration": {"form": "literal", "lambda": 0.01}, "train": {"scaling": "none"}},
    # Table 1: every iteration starts from a random policy, so there is no alpha to mutate.
    "without-fusion": {"fuse": {"policy": "random"}, "mutate": {"vary": ["beta", "draw"]}},
    # Tables 1 and 2: beta stays at its default.
    "fixed-beta": {"mutate": {"vary": ["draw", "alpha"]}},
    # Tables 1 and 2: alpha stays at its default.
    "fixed-alpha": {"mutate": {"vary": ["beta", "draw"]}},
    # Table 10: an affordance state space of randomly spliced state variables.
    "spliced-mapping": {"generate": {"mappings": "spliced"}},
    # Table 11, PoRSE-Prompt: the model is asked for dimensions beyond the goal.
    "beyond-goal": {"generate": {"beyond_goal": True}},
    # Table 12: cells of the affordance state space.
    "cells-1000": {"exploration": {"cells": 1000}},
    "cells-2000": {"exploration": {"cells": 2000}},
    "cells-3000": {"exploration": {"cells": 3000}},
    # Table 13: the two weights sum to 1, in the same ratio. Where PPO is given a normalised total, only the range that the
    # model chooses weights from is another one.
    "weights-sum-to-1": {"candidate": {"beta": 0.5, "scale": 1.0}},
    # Table 9: another model.
    "gpt-4o-mini": {"llm": {"profile": "gpt-4o-mini"}},
}

ASKED: dict[str, str] = {
    "beyond-goal": "it changes what a model is asked for",
    "gpt-4o-mini": "it changes which model is asked",
}
"""Ablations that change a question and nothing else, with what they change; where no model writes, nobody is asked."""
