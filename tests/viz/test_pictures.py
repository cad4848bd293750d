"""Pictures, films and meshes of animations and of simulations: what is drawn where."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image, ImageSequence

from gendom import viz
from gendom.errors import DeviceError, GendomError, ParameterError
from gendom.estimation import EstimateSettings, estimate
from gendom.materials import Material
from gendom.sim import Capsule, Cuboid, Gripper, Simulator, Solver, Sphere, Table, cloth, rope
from gendom.viz import Animation, Layer, films, write_film, write_report
from gendom.viz.animation import axes_of
from gendom.viz.films import Stage
from gendom.viz.palette import RECORDED_COLOR, SIMULATED_COLOR
from gendom.viz.simulation import motion_of
from gendom.viz.viewer import Viewer
from gendom.viz.views import draw_views
from viz.made_up import content, lift


def near(image, color, tolerance=60):
    """[height, width] bool: pixels of about a colour."""
    want = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)])
    return (np.abs(np.asarray(image, dtype=int) - want) < tolerance).all(axis=2)


def drawn(animation):
    """The first frame [height, width, 3]."""
    return np.asarray(Stage(animation).draw(0))


def test_points_are_drawn_where_they_are():
    """One point at the lower left, simulated too, and one at the upper right."""
    ends = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]])
    orange = Layer(name="s", color=SIMULATED_COLOR, points=[ends[:1]], radius=0.005, opacity=0.5)
    blue = Layer(name="r", color=RECORDED_COLOR, points=[ends], radius=0.005)
    # The legend shows both colours above the picture.
    picture = drawn(Animation(times=np.zeros(1), layers=(orange, blue)))[30:]
    blue_rows, blue_columns = np.nonzero(near(picture, RECORDED_COLOR))
    assert blue_columns[blue_rows < 100].mean() > 320 > blue_columns[blue_rows > 320].mean()
    assert not near(picture, SIMULATED_COLOR, 20).any()  # under the recorded one, and pale
    # an empty frame is drawn
    empty = replace(blue, points=[np.empty((0, 3)), ends])
    drawn(Animation(times=np.arange(2), layers=(empty, orange)))


def test_what_is_nearer_hides_what_is_behind():
    """A red square before and behind a blue one, as they are seen from the usual place."""
    flat = np.array([[-0.1, 0, -0.1], [0.1, 0, -0.1], [0.1, 0, 0.1], [-0.1, 0, 0.1]])
    faces, reds = np.array([[0, 1, 2], [0, 2, 3]]), []
    for y in (-0.05, 0.05):
        blue = Layer(name="blue", color="#0000ff", points=[flat], faces=faces)
        red = Layer(name="red", color="#ff0000", points=[0.5 * flat + [0, y, 0]], faces=faces)
        picture = drawn(Animation(times=np.zeros(1), layers=(blue, red)))[60:]
        reds.append(np.count_nonzero((picture[..., 0] > 120) & (picture[..., 2] < 60)))
    assert reds[0] > 10_000 and reds[1] == 0


@pytest.mark.parametrize(
    ("size", "turn"), [((1.0, 0.2, 0.5), 25.0), ((0.2, 1.0, 0.5), 115.0), ((1.0, 0.8, 0.01), 25.0)]
)
def test_the_view_is_of_the_broad_side(size, turn):
    points = np.random.default_rng(0).uniform(size=(200, 3)) * size
    layer = Layer(name="a", color="#000000", points=[points])
    view = Animation(times=np.zeros(1), layers=(layer,)).view
    assert np.degrees(view) == pytest.approx([turn, 18.0])
    right, up, away = axes_of(*view)
    np.testing.assert_allclose(np.cross(right, up), -away, atol=1e-12)
    assert away[2] < 0.0 < up[2] and right[2] == 0.0
    # from three sides
    image = np.asarray(draw_views([points, points + 0.1], table=0.0))
    assert image.shape == (420, 1260, 3) and near(image, RECORDED_COLOR).any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"times": np.empty(0)}, "times: must increase"),
        ({"times": np.zeros(20)}, "times: must increase"),
        ({"points": [np.zeros((1, 3))] * 2}, "a: has 2 frames, but there are 20 times"),
        ({"points": np.zeros((20, 5, 2))}, r"a\[0\] must be \[n, 3\] .* shape \[5, 2\]"),
        ({"points": np.full((20, 5, 3), np.nan)}, r"a\[0\] must be finite, got nan"),
        ({"distance": ("rms", np.zeros(3))}, r"distance must be \[20\] numbers, got shape \[3\]"),
    ],
)
def test_bad_animations(change, message):
    given = {"times": np.arange(20), "points": np.zeros((20, 5, 3)), **change}
    with pytest.raises(GendomError, match=message):
        layer = Layer(name="a", color="#000000", points=given.pop("points"))
        Animation(layers=(layer,), **given)


# ---- files ---------------------------------------------------------------------------------------


def durations(path):
    with Image.open(path) as image:
        assert (image.format, image.width, image.info["loop"]) == ("GIF", 640, 0)
        return [frame.info["duration"] for frame in ImageSequence.Iterator(image)]


def test_films_last_as_long_as_the_motion(tmp_path, monkeypatch):
    monkeypatch.setattr(films, "FRAMES", 30)
    path = tmp_path / "lift.gif"
    write_film(path, lift(frames=8))
    assert durations(path) == [100] * 7 + [1100]
    assert list(tmp_path.iterdir()) == [path]
    # long ones stay small
    places = [np.array([[x, 0.0, 0.0]]) for x in range(500)]
    dot = Layer(name="a", color="#000000", points=places)
    write_film(path, Animation(times=0.1 * np.arange(500), layers=(dot,)))
    shown = durations(path)
    assert len(shown) <= 31 and sum(shown) == pytest.approx(50_000 + 1_000, rel=0.04)
    cv2, s = pytest.importorskip("cv2", reason="the extra camera"), made()
    viz.save(tmp_path / "a.mp4", s, s.run(TIMES), TIMES)
    film = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    count, rate = film.get(cv2.CAP_PROP_FRAME_COUNT), film.get(cv2.CAP_PROP_FPS)
    assert count == 4 and rate == pytest.approx(10.0)  # as long as the shortest of the motion


def test_failure_keeps_the_old_file(tmp_path):
    path = tmp_path / "shown.gif"
    path.write_text("old")
    none = Layer(name="a", color="#000000", points=[np.empty((0, 3))])
    for write in (write_film, lambda at, of: write_report(at, content(lift=of))):
        with pytest.raises(GendomError, match="no points at all"):
            write(path, Animation(times=np.zeros(1), layers=(none,)))
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


# ---- simulations ---------------------------------------------------------------------------------


TIMES = np.array([0.0, 0.1, 0.25])
AROUND = [
    Capsule.between((0.1, -0.1, 0.05), (0.1, 0.1, 0.05), radius=0.02),
    Cuboid(size=(0.1, 0.08, 0.06), rounding=0.01, position=[(0, 0.2, 0), (0, 0.3, 0)], time=[0, 1]),
    Sphere(radius=0.03, position=(0.2, 0.2, 0.2)),
]


def made(body=None, obstacles=AROUND, **more):
    body = body or rope(diameter=0.01, length=0.2, start=(0, 0, 0.1), points=21)
    hand = Gripper.still(body.points[0], radius=0.015)
    return Simulator(body, [Material(E=1e5)] * 2, grippers=[hand], table=Table(height=0.0),
                     obstacles=obstacles, **more)  # fmt: skip


def volume(x, faces):
    """Of what triangles enclose, above 0 if they are counter-clockwise from outside [m^3]."""
    a, b, c = np.moveaxis(x[faces], 1, 0)
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def test_skins_of_obstacles_lie_on_them_and_enclose_them():
    s = made()
    scene = motion_of(s, s.run(TIMES), TIMES)
    sizes = [np.pi * 4e-4 * 0.2 + 4 / 3 * np.pi * 8e-6, 0.1 * 0.08 * 0.06, 4 / 3 * np.pi * 2.7e-5]
    names = ["rope", "capsule 0", "cuboid 1", "sphere 2", "gripper"]
    assert [layer.name for layer in scene.layers] == names
    for of, layer, size in zip(AROUND, scene.layers[1:], sizes, strict=False):
        for k, t in enumerate(TIMES):
            assert np.abs(of.distance(layer.at(k), float(t))).max() < 1e-12
        assert 0.9 < volume(layer.at(0), layer.faces) / size < 1.0
    skin = scene.layers[0]
    assert 0.8 < volume(skin.at(0), skin.faces) / (np.pi * 25e-6 * 0.2) < 1.0


@pytest.mark.parametrize("kind", ["rope", "cloth"])
def test_meshes_have_the_faces_of_the_skin(tmp_path, kind):
    trimesh = pytest.importorskip("trimesh", reason="the extra viz")
    sheet = cloth(width=0.1, height=0.08, thickness=0.001, dx=0.02, corner=(0, 0, 0.2))
    s = made(sheet if kind == "cloth" else None)
    x = s.run(TIMES)
    for form in (".glb", ".obj"):
        viz.save(tmp_path / f"a{form}", s, x, TIMES, world=1)
        found = trimesh.load(tmp_path / f"a{form}", force="scene")
        vertices = np.concatenate([mesh.vertices for mesh in found.dump()])
        if form == ".glb":  # y up
            vertices = vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
            assert set(found.geometry) == {kind, "capsule 0", "cuboid 1", "sphere 2"}
        layers = motion_of(s, x, TIMES, world=1).layers
        points = np.concatenate([of.at(2) for of in layers if of.kind == "surface"])
        for ends in (np.min, np.max):
            np.testing.assert_allclose(ends(vertices, axis=0), ends(points, axis=0), atol=1e-6)


def test_the_viewer_serves_until_it_is_stopped(rope_lift, monkeypatch):
    """Recordings and what was found of them have sliders."""
    found = estimate(rope_lift.seen(), EstimateSettings(starts=1, scene=rope_lift.settings))
    shell = type("Shell", (), {"kernel": None})
    with monkeypatch.context() as notebook:  # shows a player in their place
        notebook.setitem(sys.modules, "IPython", type("I", (), {"get_ipython": shell}))
        page = viz.show(made())._repr_html_()
        assert page.startswith("<iframe srcdoc=") and len(page) > 30_000
    pages = []
    monkeypatch.setattr(Viewer, "serve", lambda viewer: pages.append(viewer.page().decode()))
    for shown in (made(), rope_lift.seen(), found):
        assert viz.show(shown, port=0) is None
    assert '"name":"rope"' in pages[0] and "Reset parameters" not in pages[0]
    assert all("recorded" in page and "Reset parameters" in page for page in pages[1:])
    assert f"&quot;value&quot;: {found.theta.E_over_rho}" in pages[2]
    with pytest.raises(ParameterError, match="simulator must be a Simulator"):
        viz.show(np.zeros((3, 3)), port=0)


def test_particles_are_dots(tmp_path):
    body = rope(diameter=0.02, length=0.06, start=(0, 0, 0.05), cells_across=1.0)
    s = Simulator(body, [Material(E=1e5)], solver=Solver(engine="mpm"))
    assert motion_of(s).layers[0].kind == "dots"
    viz.save(tmp_path / "a.gif", s)
    with pytest.raises(ParameterError, match="particles have no faces"):
        viz.save(tmp_path / "a.obj", s)


@pytest.mark.parametrize(
    ("words", "options", "said"),
    [
        (("a.stl",), {}, "a.stl: cannot save .stl; choose .glb, .obj, .gif, .mp4"),
        (("a.gif", np.zeros((2, 5, 3))), {}, r"x must be \[T, 21, 3\] or \[T, 2, 21, 3\] numbers"),
        (("a.gif", np.zeros((2, 21, 3)), [1.0, 1.0]), {}, "times: must be 2 that increase"),
        (("a.gif",), {"world": 2}, "no world 2"),
    ],
)
def test_what_cannot_be_saved(tmp_path, words, options, said):
    with pytest.raises(ParameterError, match=said):
        viz.save(tmp_path / words[0], made(), *words[1:], **options)
    assert not list(tmp_path.iterdir())


def test_missing_packages_are_named(tmp_path, monkeypatch):
    for name, form, said in (("trimesh", "obj", "viz"), ("cv2", "mp4", "camera")):
        with monkeypatch.context() as without:
            without.setitem(sys.modules, name, None)
            with pytest.raises(DeviceError, match=rf"pip install.*\[{said}\]"):
                viz.save(tmp_path / f"a.{form}", made())
    assert not list(tmp_path.iterdir())
