"""Measuring policies in the simulator and in the MuJoCo test scene."""

from gendom.evaluation.protocol import Cases, Score, choose, draw_cases, judge, score

__all__ = ["Cases", "Score", "choose", "draw_cases", "judge", "score"]
