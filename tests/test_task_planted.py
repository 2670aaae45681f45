"""The tests of what every task promises see a fault that is planted: a force, an action or a bound that is not held."""

import pytest

import test_meaning_tasks as meaning
import test_task_conformance as conformance
from porse.sim.physics import CpuPhysics
from porse.tasks import TASKS, make_task
from porse.tasks.base import Task
from porse.tasks.hands.two_hands import TwoHandTask


def forces_stay_after_a_reset(monkeypatch):
    restart = CpuPhysics.restart

    def keeping(self, ids):
        force = self.force.clone()
        restart(self, ids)
        self.force[:] = force

    monkeypatch.setattr(CpuPhysics, "restart", keeping)


def forces_add_up(monkeypatch):
    act = TwoHandTask._act

    def adding(self):
        before = self._physics.force.clone()
        act(self)
        self._physics.force[:] += before

    monkeypatch.setattr(TwoHandTask, "_act", adding)


def measured_forces_stay_after_a_reset(monkeypatch):
    started = TwoHandTask._measure_started

    def keeping(self, ids):
        before = self.dof_force_tensor.clone()
        started(self, ids)
        self.dof_force_tensor = before

    monkeypatch.setattr(TwoHandTask, "_measure_started", keeping)


def actions_stay_after_a_reset(monkeypatch):
    reset = Task.reset

    def keeping(self, mask):
        before = self.actions.clone()
        reset(self, mask)
        self.actions = before

    monkeypatch.setattr(Task, "reset", keeping)


def actions_are_not_bounded(monkeypatch):
    act = TwoHandTask._act
    step = Task.step

    def remembering(self, actions):
        self.asked = actions
        step(self, actions)

    def unbounded(self):
        self.actions = self.asked
        act(self)

    monkeypatch.setattr(Task, "step", remembering)
    monkeypatch.setattr(TwoHandTask, "_act", unbounded)


def joints_are_not_bounded(monkeypatch):
    scene = TASKS["Pen"].scene.__func__

    def loose(cls):
        spec = scene(cls)
        for joint in spec.joints:
            if joint.name.endswith("J3"):
                # The declared range stays; nothing pushes the joint back into it.
                joint.solimp_limit = [1e-4, 1e-4, 1.0, 0.5, 2.0]
                joint.solref_limit = [10.0, 1.0]
        for actuator in spec.actuators:
            actuator.forcelimited = False
            actuator.gainprm[0], actuator.biasprm[1] = 50.0, -1.0
        return spec

    monkeypatch.setattr(TwoHandTask, "scene", classmethod(loose))


def resets(name):
    meaning.test_a_reset_clears_what_belongs_to_the_episode_and_leaves_the_others(name, make_task(name, 3, seed=1))


PLANTED = [
    (forces_stay_after_a_reset, conformance.test_a_reset_leaves_no_force_action_or_control_of_the_episode_before),
    (forces_add_up, conformance.test_a_force_acts_in_its_own_step_only),
    (measured_forces_stay_after_a_reset, resets),
    (actions_stay_after_a_reset, conformance.test_a_reset_leaves_no_force_action_or_control_of_the_episode_before),
    (actions_stay_after_a_reset, resets),
    (actions_are_not_bounded, conformance.test_actions_beyond_their_bounds_are_the_bounds),
    (joints_are_not_bounded, conformance.test_limits_of_joints_and_forces_hold),
]


@pytest.mark.parametrize(("plant", "sees"), PLANTED, ids=lambda value: value.__name__)
def test_a_planted_fault_is_seen(plant, sees, monkeypatch):
    sees("Pen")
    plant(monkeypatch)
    with pytest.raises(AssertionError):
        sees("Pen")
