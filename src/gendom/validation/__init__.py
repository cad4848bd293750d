"""The simulator against mechanics that has an answer on paper."""

from gendom.validation.check import Case, Check, Settings
from gendom.validation.suite import CASES, Result, choose, run_cases

__all__ = ["CASES", "Case", "Check", "Result", "Settings", "choose", "run_cases"]
