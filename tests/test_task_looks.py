"""What is only seen changes nothing, what collides is where it is seen, and pictures show a scene under a sky."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from porse.picture import FOLLOWED, VIEWS, _shadows, first_simulation, follow
from porse.tasks import TASKS, looks, make_task

NAMES = sorted(TASKS)
PICTURES = Path(__file__).parent.parent / "docs" / "pictures"
ROUND = {"BottleCap", "GraspAndPlace", "Kettle", "LiftUnderarm", "Pen", "Scissors", "SwingCup"}
"""Tasks whose objects are seen as other shapes than they collide as."""


def seen_only(spec):
    """Returns the names of the geoms that are looks."""
    return [geom.name for geom in spec.geoms if geom.name.endswith("_look")]


def rolled(model):
    """Returns the state after a fifth of a second without controls, in which objects settle."""
    data = mujoco.MjData(model)
    for _ in range(24):
        mujoco.mj_step(model, data)
    return data.qpos.copy()


@pytest.mark.parametrize("name", sorted(ROUND))
def test_a_scene_without_its_looks_is_the_same_to_the_bit(name):
    spec = TASKS[name].scene()
    spec.option.timestep = TASKS[name].CONTROL_DT / TASKS[name].SUBSTEPS
    dressed = spec.compile()
    names = seen_only(spec)
    assert names
    for geom in names:
        spec.delete(spec.geom(geom))
    bare = spec.compile()
    assert bare.ngeom == dressed.ngeom - len(names)
    assert np.array_equal(bare.body_mass, dressed.body_mass)
    assert np.array_equal(bare.body_inertia, dressed.body_inertia)
    assert np.array_equal(rolled(bare), rolled(dressed))


@pytest.mark.parametrize("name", NAMES)
def test_looks_touch_nothing_and_what_is_out_of_sight_collides(name):
    spec = TASKS[name].scene()
    model = spec.compile()
    assert bool(seen_only(spec)) == (name in ROUND)
    for geom in seen_only(spec):
        assert model.geom(geom).contype[0] == model.geom(geom).conaffinity[0] == 0
    own = [g for g in range(model.ngeom) if not model.geom(g).name.startswith(("left/", "right/"))]
    hidden = [g for g in own if model.geom_group[g] == looks.HIDDEN]
    assert bool(hidden) == (name in ROUND)
    assert all(model.geom_contype[g] for g in hidden)


def corners(model, data, geom):
    """Returns the corners of a mesh in the world (m)."""
    mesh = model.geom_dataid[geom]
    start = model.mesh_vertadr[mesh]
    own = model.mesh_vert[start : start + model.mesh_vertnum[mesh]]
    return data.geom_xpos[geom] + own @ data.geom_xmat[geom].reshape(3, 3).T


@pytest.mark.parametrize(
    ("task", "geom", "point", "near"),
    [
        ("Kettle", "spout_look", (0.0, -0.2, 0.57), 0.02),
        ("Kettle", "handle_look", (0.0, 0.15, 0.5), 0.02),
        ("SwingCup", "right_handle_look", (0.0, 0.062, 0.685), 0.02),
        ("SwingCup", "left_handle_look", (0.0, -0.06, 0.685), 0.02),
        ("LiftUnderarm", "right_handle_look", (0.0, -0.426, 0.521), 0.02),
    ],
)
def test_what_hands_reach_for_is_seen_where_the_variable_says(task, geom, point, near):
    """By the points of the original's handles: the kettle's spout is 20 cm before its base and 7 cm above it."""
    model = TASKS[task].scene().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    gaps = np.linalg.norm(corners(model, data, model.geom(geom).id) - np.array(point), axis=1)
    assert gaps.min() < near


@pytest.mark.parametrize(
    ("task", "low", "high"),
    # 0.7 m, and 0.4441 m and 0.4811 m to the middles of the rails; inward the door is turned upside down.
    [("DoorOpenOutward", 0.2559, 1.1811), ("DoorOpenInward", 0.2189, 1.1441)],
)
def test_a_door_has_two_thin_rails_and_nothing_beside_its_panels(task, low, high):
    model = TASKS[task].scene().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    heights = sorted(float(data.geom(name).xpos[2]) for name in ("lower_rail", "upper_rail"))
    assert heights == pytest.approx([low, high], abs=1e-4)
    for name in ("lower_rail", "upper_rail"):
        assert sorted(2.0 * model.geom(name).size) == pytest.approx([0.0038, 0.049, 1.762])

    def first(y: float, z: float) -> str:
        """Returns the first geom that a ray from behind the door, along +x, meets."""
        hit, normal = np.zeros(1, np.int32), np.zeros((3, 1))
        mujoco.mj_ray(model, data, np.array([-2.0, y, z]), np.array([1.0, 0.0, 0.0]), None, 1, -1, hit, normal)
        return model.geom(int(hit[0])).name if hit[0] >= 0 else ""

    assert [first(y, 0.7) for y in (-0.75, -0.55, 0.55, 0.75)] == ["", "", "", ""]
    assert {first(y, 0.7) for y in (-0.2, 0.2)} == {"link_1", "link_2"}
    assert {first(y, z) for y in (-0.75, 0.75) for z in (low, high)} == {"lower_rail", "upper_rail"}


@pytest.mark.parametrize("name", NAMES)
def test_every_scene_has_a_sky_a_tiled_floor_and_one_light(name):
    model = TASKS[name].scene().compile()
    assert [model.tex(t).type[0] for t in range(model.ntex)].count(mujoco.mjtTexture.mjTEXTURE_SKYBOX) == 1
    assert model.mat(model.geom("floor").matid[0]).name == "tiles"
    assert model.nlight == 1


@pytest.mark.parametrize("name", NAMES)
def test_no_picture_has_a_black_background(name):
    imageio = pytest.importorskip("imageio.v3")
    pixels = imageio.imread(PICTURES / f"{name}.png").astype(int)
    assert pixels[0].mean() > 60
    assert (pixels.max(axis=2) < 25).mean() < 0.05
    assert pixels.std() > 15


def test_every_task_of_the_registry_has_a_view():
    assert VIEWS.keys() == TASKS.keys()
    assert FOLLOWED.keys() <= TASKS.keys()


def test_a_cube_has_six_colours():
    spec = TASKS["BlockStack"].scene()
    model = spec.compile()
    sides = np.asarray(model.tex("cube").data).reshape(6, 16, 16, 3)
    middles = {tuple(side[8, 8].tolist()) for side in sides}
    assert len(middles) == 6


def test_a_lathe_is_round_and_a_tube_as_wide_as_said():
    spec = mujoco.MjSpec()
    looks.add_lathe(spec, "vase", ((0.0, -0.1), (0.05, -0.1), (0.08, 0.0), (0.0, 0.2)))
    looks.add_tube(
        spec, "ring", [(0.3, 0.0, 0.0), (0.0, 0.0, 0.3), (-0.3, 0.0, 0.0), (0.0, 0.0, -0.3)], (0.02,), closed=True
    )
    for name in ("vase", "ring"):
        looks.look(spec.worldbody, f"{name}_look", name, looks.RED)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    vase, ring = (corners(model, data, model.geom(f"{name}_look").id) for name in ("vase", "ring"))
    assert np.hypot(vase[:, 0], vase[:, 2]).max() == pytest.approx(0.08, abs=1e-6)
    assert (vase[:, 1].min(), vase[:, 1].max()) == pytest.approx((-0.1, 0.2), abs=1e-6)
    assert np.abs(ring[:, 1]).max() == pytest.approx(0.02, abs=1e-6)
    assert np.abs(ring[:, 0]).max() == pytest.approx(0.32, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "place", "lookat", "distance"),
    [
        # Half way from the target at (0, 0, 1), and farther back by the other half: 0.9 + |(0.4, 0.3, 0.0)|.
        ("Quadcopter", (0.8, 0.6, 1.0), (0.4, 0.3, 1.0), 1.4),
        # Beside the torso wherever it runs, at one height; 0.25 m higher than the view's place.
        ("Humanoid", (30.0, -4.0, 1.2), (30.0, -4.0, 0.95), 3.05),
    ],
)
def test_the_camera_goes_with_what_moves_far(name, place, lookat, distance):
    task = make_task(name, 1, seed=0)
    model, data = first_simulation(task)
    data.qpos[0:3] = place
    mujoco.mj_forward(model, data)
    view = mujoco.MjvCamera()
    follow(name, data, view)
    assert view.lookat.tolist() == pytest.approx(lookat)
    assert view.distance == pytest.approx(distance)


def test_shadows_of_a_film_leave_those_of_pictures_as_they_are():
    model, _ = first_simulation(make_task("Quadcopter", 1, 0))
    own = model.vis.quality.shadowsize
    with _shadows(model, 512):
        assert model.vis.quality.shadowsize == 512
    with _shadows(model, None):
        assert model.vis.quality.shadowsize == own == 4096


def test_the_camera_of_a_table_stays():
    view = mujoco.MjvCamera()
    before = (view.lookat.tolist(), view.distance)
    follow("Kettle", first_simulation(make_task("Kettle", 1, seed=0))[1], view)
    assert (view.lookat.tolist(), view.distance) == before
