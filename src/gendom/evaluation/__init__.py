"""Measuring policies in the simulator."""

from gendom.evaluation.protocol import Cases, Score, draw_cases, score

__all__ = ["Cases", "Score", "draw_cases", "score"]
