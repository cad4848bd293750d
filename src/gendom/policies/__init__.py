"""Policies: trained with torch (`gendom.policies.train`), run without it."""

from gendom.policies.policy import Action, Column, Description, GoalRange, Outside, Policy

__all__ = ["Action", "Column", "Description", "GoalRange", "Outside", "Policy"]
