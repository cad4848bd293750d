"""Gymnasium environments by name, registered when this module is imported, here by Gymnasium:

gymnasium.make_vec("gendom.environments:gendom/RopeReachingSteps-v0", num_envs=64)

``gendom/RopeReaching-v0`` and so on carry out one action in the MuJoCo test scene, the ``Steps``
are led step by step in our simulator.
"""

from collections.abc import Iterable

import gymnasium

BUILT_IN = ("rope-reaching", "rope-casting", "cloth-spreading", "cloth-dragging")


def register(names: Iterable[str] = BUILT_IN) -> None:
    """Register the environments of tasks that have none yet."""
    for name in names:
        title = "gendom/" + "".join(word.capitalize() for word in name.split("-"))
        if f"{title}-v0" not in gymnasium.registry:
            kwargs, steps = {"task": name}, "gendom.tasks.envs:Steps"
            world = "gendom.reality.envs:TaskEnv"
            gymnasium.register(f"{title}-v0", entry_point=world, kwargs=kwargs)
            gymnasium.register(
                f"{title}Steps-v0", entry_point=f"{steps}Env", kwargs=kwargs,
                vector_entry_point=f"{steps}VectorEnv", disable_env_checker=True,
            )  # fmt: skip


register()
