"""Recordings for the viewer: shown, and simulated with any parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from gendom.datasets import Recording
from gendom.estimation import UNKNOWNS, LiftScene, Theta, chamfers, replay
from gendom.estimation.replayed import of_all_frames
from gendom.viz.animation import Animation
from gendom.viz.layers import lift_animation
from gendom.viz.quantities import length_text, quantity_text
from gendom.viz.viewer.sliders import MATERIAL, SETUP, SliderParameter, ViewerModel


def recording_model(scene: LiftScene, theta: Theta, title: str) -> ViewerModel:
    """A recording that is replayed with the parameters of sliders.

    Args:
        scene: What was recorded, with all frames that are shown.
        theta: Parameters at first.
        title: One line.
    """

    def simulate(values: Mapping[str, float], go_on: Callable[[], None]) -> Iterator[Animation]:
        """The simulated object, then with its distance from the clouds."""
        given = theta.with_values(values)
        x = replay(scene, [given], on_frame=lambda _: go_on())[:, 0]
        facts = _facts(scene, given)
        yield lift_animation(scene, x, given, facts=facts)
        distance = "Chamfer", chamfers(scene, x, given)[0]
        yield lift_animation(scene, x, given, facts=facts, distance=distance)

    return ViewerModel(
        title=title,
        notes=scene.notes,
        initial=lift_animation(scene),
        parameters=_parameters(scene, theta),
        simulate=simulate,
    )


def unknown_object(recording: Recording) -> tuple[LiftScene, Theta]:
    """All of a recording, with the middle of the priors of an unknown object's parameters.

    Raises:
        RecordingError: The recording shows too little to place the object.
    """
    scene = LiftScene.of(recording)
    theta = scene.prior()[1].with_values(scene.guesses[len(scene.guesses) // 2])
    return of_all_frames(scene, recording), theta


def _parameters(scene: LiftScene, theta: Theta) -> tuple[SliderParameter, ...]:
    """Unknowns of the object, those that are searched, and those that have other values than usual,
    within the ranges that are searched."""
    searched = scene.prior()[0].names
    names = [
        u.name
        for u in UNKNOWNS.values()
        if scene.kind in u.kinds and (u.material or u.name in searched or theta[u.name] != u.usual)
    ]
    if scene.recording.table_height is None:
        names.remove("friction")
    prior = scene.prior(tuple(names))[0]
    ranges = zip(prior.unknowns, prior.low, prior.high, strict=True)
    return tuple(
        SliderParameter(
            name=u.name,
            label=u.symbol,
            unit=u.unit,
            meaning=u.meaning,
            group=MATERIAL if u.material else SETUP,
            ends=(u.value(low), u.value(high)),
            value=theta[u.name],
            log=u.log,
        )
        for u, low, high in ranges
    )


def _facts(scene: LiftScene, theta: Theta) -> tuple[tuple[str, str], ...]:
    modulus = theta.E_over_rho
    bending = scene.bending_length(modulus, theta.thickness)
    facts = [("bending length", length_text(bending))]
    if scene.recording.object.mass is not None:
        facts.insert(0, ("E", quantity_text("E", modulus * scene.density_of(theta))))
    return tuple(facts)
