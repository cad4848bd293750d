"""A recording for the viewer: its clouds, and the object simulated with any parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gendom.cli.replay import of_all_frames, of_recording, replay_setup
from gendom.cli.view_layers import arm_layer, gripper_layer, object_layer
from gendom.datasets import Recording
from gendom.datasets.recording import is_recording
from gendom.errors import GendomError, RobotError
from gendom.estimation import UNKNOWNS, LiftScene, Theta, chamfers, replay
from gendom.estimation.replay import lattice, middle
from gendom.robot import ARMS, DOWN, inverse_kinematics
from gendom.viz.palette import RECORDED_COLOR, SIMULATED_OPACITY
from gendom.viz.report.quantities import length_text, quantity_text
from gendom.viz.viewer import (
    MATERIAL,
    SETUP,
    Layer,
    MeshLayer,
    Parameter,
    PointLayer,
    ViewerScene,
)

CHAMFER = "Chamfer distance [mm]"

_Array = NDArray[np.floating]


class RecordingModel:
    """A recording that is replayed with the parameters of sliders.

    Args:
        scene: What was recorded, with all frames that are shown.
        theta: Parameters at first.
        title: One line.
    """

    cases = ("recording", 1)

    def __init__(self, scene: LiftScene, theta: Theta, title: str):
        self.scene, self.theta, self.title = scene, theta, title
        notes = list(scene.notes)
        if scene.kind == "cloth" or not scene.thin:
            notes.insert(0, "This takes longer to simulate than a rope as a rod.")
        self._arm = arm_of(scene)
        if self._arm is not None:
            notes.append("The arm is drawn with its fingers pointing down.")
        self.notes = tuple(notes)
        self.initial = self._shown(())
        self._parameters = _parameters(scene, theta)

    @classmethod
    def of(cls, recording: Recording, title: str) -> RecordingModel:
        """With the middle of the priors of an unknown object's parameters.

        Raises:
            RecordingError: The recording shows too little to place the object.
        """
        scene = LiftScene.of(recording)
        theta = scene.prior()[1].with_values(scene.guesses[len(scene.guesses) // 2])
        return cls(of_all_frames(scene, recording), theta, title)

    @classmethod
    def with_params(
        cls, recording: Recording, params: Mapping[str, Any], where: str, title: str
    ) -> RecordingModel:
        """With the parameters of an estimate; arguments and errors as those of `replay_setup`."""
        return cls(*replay_setup(recording, params, where, "cpu"), title)

    def parameters(self, case: int) -> tuple[Parameter, ...]:
        """Those of the object, and of how it is held."""
        return self._parameters

    def simulate(
        self, case: int, values: Mapping[str, float], go_on: Callable[[], None]
    ) -> Iterator[ViewerScene]:
        """The simulated object, then with its distance from the clouds."""
        scene, theta = self.scene, self.theta.with_values(values)
        x = replay(scene, [theta], on_frame=lambda _: go_on())[:, 0]
        simulated, facts = self._simulated(x, theta), _facts(scene, theta)
        yield self._shown((simulated,), facts=facts)
        distance = 1e3 * chamfers(scene, x, theta)[0]
        yield self._shown((simulated,), facts=facts, curves={CHAMFER: distance})

    def _shown(self, layers: tuple[Layer, ...], **other: Any) -> ViewerScene:
        scene, frames = self.scene, list(self.scene.frames)
        recording = self.scene.recording
        counts = np.diff(recording.offsets)[frames]
        # small, or a dense cloud would hide the object
        dot = scene.size * (0.006 if np.median(counts) < 400 else 0.003)
        recorded = PointLayer(
            name="recorded",
            color=RECORDED_COLOR,
            points=recording.frames(frames),
            radius=dot,
        )
        axis = None if recording.gripper_axis is None else recording.gripper_axis[frames]
        return ViewerScene(
            times=recording.time[frames],
            layers=(
                recorded,
                *layers,
                gripper_layer(recording.gripper_position[frames], scene.size, axis),
                *([] if self._arm is None else [self._arm]),
            ),
            table_height=recording.table_height,
            **other,
        )

    def _simulated(self, x: _Array, theta: Theta) -> Layer:
        scene = self.scene
        columns, rows = lattice(scene)
        counts = None if scene.kind == "rope" else (len(rows), len(columns))
        return object_layer(
            "simulated", scene.body_of(theta), middle(scene, x), counts, SIMULATED_OPACITY
        )


def find_recording(params: Mapping[str, Any], where: Path) -> Path:
    """The recording of an estimate: a file or folder beside it, or one folder above.

    It is identified by `Recording.digest`. Estimates of older versions do not state that; their
    recording begins with the same points and has all compared frames.

    Args:
        params: The estimate's JSON.
        where: Its file.

    Raises:
        GendomError: It is not there, or several files of an older version's estimate fit.
    """
    folder = where.absolute().parent
    fix = f"name it: gendom view RECORDING --params {where}"
    # files of older versions are of one recording
    stated = params.get("recordings", [params])
    fits: dict[str, Path] = {}
    other: list[Path] = []
    for path in [*_recordings_in(folder), *_recordings_in(folder.parent)]:
        try:
            recording = Recording.read(path, on_warning=lambda _: None)
        except GendomError:  # another kind of file
            continue
        digest = recording.digest
        if any(own.get("digest") == digest for own in stated):
            return path
        if (own := of_recording(params, recording)) is None:
            continue
        if "digest" in own or 1 + max(own.get("compared", [0])) > recording.num_frames:
            other.append(path)
        else:
            fits.setdefault(digest, path)
    if len(fits) > 1:
        raise GendomError(
            f"may be of any of {', '.join(map(str, fits.values()))}", where=str(where), fix=fix
        )
    if fits:
        return next(iter(fits.values()))
    similar = f"; {other[0]} begins like it, but is cut or changed" if other else ""
    raise GendomError(
        f"its recording is neither beside it nor in the folder above{similar}",
        where=str(where),
        fix=fix,
    )


def _recordings_in(folder: Path) -> list[Path]:
    """What may be recordings, by name."""
    inside = [*folder.glob("*.npz"), *(p for p in folder.iterdir() if p.is_dir())]
    return sorted(path for path in inside if is_recording(path))


def arm_of(scene: LiftScene) -> MeshLayer | None:
    """The arm that a recording names, its fingers pointing down where the gripper was.

    Recordings have the place of the gripper, not how it is turned.

    Args:
        scene: What was recorded.

    Returns:
        None where the recording names no known arm, has several grippers, or the arm cannot reach.
    """
    recording = scene.recording
    arm = ARMS.get(str(recording.extra.get("robot")))
    if arm is None or recording.num_grippers != 1:
        return None
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(DOWN).as_matrix()
    q: list[_Array] = []
    try:
        for position in recording.gripper_position[list(scene.frames), 0]:
            T[:3, 3] = position
            near = q[-1] if q else None
            q.append(inverse_kinematics(arm, T, near=near, starts=2 if q else 24))
    except RobotError:
        return None
    return arm_layer(arm, np.array(q), scene.body.thickness)


def _parameters(scene: LiftScene, theta: Theta) -> tuple[Parameter, ...]:
    """All unknowns that change what is simulated, within the ranges that are searched."""
    searched = scene.prior()[0].names
    names = [
        u.name
        for u in UNKNOWNS.values()
        if scene.kind in u.kinds and (u.material or u.name in searched or u.on_replay is not None)
    ]
    if scene.recording.table_height is None:
        names.remove("friction")
    prior = scene.prior(tuple(names))[0]
    made = []
    for u, low, high in zip(prior.unknowns, prior.low, prior.high, strict=True):
        value = getattr(theta, u.name)
        made.append(
            Parameter(
                name=u.name,
                label=u.symbol,
                unit=u.unit,
                meaning=u.meaning,
                group=MATERIAL if u.material else SETUP,
                low=min(u.value(low), value),
                high=max(u.value(high), value),
                value=value,
                log=u.log,
            )
        )
    return tuple(made)


def _facts(scene: LiftScene, theta: Theta) -> tuple[tuple[str, str], ...]:
    modulus = theta.E_over_rho
    bending = scene.bending_length(modulus, theta.thickness)
    facts = [("bending length", length_text(bending))]
    if scene.recording.object.mass is not None:
        facts.insert(0, ("E", quantity_text("E", modulus * scene.density_of(theta))))
    return tuple(facts)
