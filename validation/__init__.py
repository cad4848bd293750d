"""The simulator against mechanics that has an answer on paper.

A case is a body, a motion and a formula; the engine is a parameter. Run it from a clone of the
repository with ``make validate`` or ``python -m validation``; ``docs/validation.md`` has the
results.
"""

from importlib import import_module

from validation.bench import CASES, Bench, Case, Result, Row, choose, run_case

for _theme in (
    "motion", "bending", "vibration", "stretching", "buckling", "friction", "stability",
):  # fmt: skip
    import_module(f"validation.{_theme}")

__all__ = ["CASES", "Bench", "Case", "Result", "Row", "choose", "run_case"]
