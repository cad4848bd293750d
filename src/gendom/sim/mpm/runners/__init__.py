"""The ways to run worlds, one file each: ``cpu``, ``block_per_world``, ``graph``."""
