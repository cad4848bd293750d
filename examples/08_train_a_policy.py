"""Simulate demonstrations, train a small policy on them and evaluate it (about 15 s; needs the
extra `train`).

    python examples/08_train_a_policy.py --out casting

Shipped policies have 20,000 demonstrations or more and 300 epochs; this one has 400 and 60, so it
misses by more. `gendom dataset`, `gendom train` and `gendom evaluate` do the same from a shell.
"""

import tempfile
from pathlib import Path

import tyro

from gendom import Policy, RopeCasting
from gendom.datasets import generate
from gendom.policies import Demonstrations, Training, score, train
from gendom.tasks import Demonstrator, draw_cases


def main(out: Path | None = None, size: int = 400, epochs: int = 60) -> None:
    """Write the demonstrations and casting.onnx.

    Args:
        out: Folder to write to; by default a new temporary one.
        size: Number of demonstrations.
        epochs: Passes over them, for each network.
    """
    out = Path(tempfile.mkdtemp(prefix="gendom-")) if out is None else out
    task = RopeCasting()
    table = generate(Demonstrator(task=task), size, out / "casts", seed=0)
    print(f"{len(table)} demonstrations, the first one:")
    print(table.slice(0, 1).to_pylist()[0])

    demonstrations = Demonstrations.read(out / "casts")
    mine = train(demonstrations, out / "casting.onnx", Training(epochs=epochs, seed=0))
    print(mine)

    cases = draw_cases(task, 20, seed=1)  # objects and goals that the policy has not seen
    for name, policy in (("this one", mine), ("shipped", Policy.pretrained("rope-casting"))):
        errors = score(policy, cases).summary()["error_over_size"]
        print(f"{name}: misses by {100 * errors['mean']:.2f} % of the rope's length in the mean")


if __name__ == "__main__":
    tyro.cli(main)
