"""Searches: functions from a `Problem` to what they have `Found`."""
