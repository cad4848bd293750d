"""Registers ``gendom`` among LeRobot's policies; LeRobot imports packages of this name."""

from lerobot_policy_gendom.configuration_gendom import GendomConfig

__all__ = ["GendomConfig"]
