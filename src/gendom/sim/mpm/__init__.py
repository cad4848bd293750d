"""The material point method: an engine behind ``gendom.sim.Simulator``.

Read ``step`` first: the algorithm. ``internal_forces``, ``transfer``, ``boundary``,
``gripped`` and ``grid`` are its stages, ``types`` the structs that they work on, ``particles`` how
particles are stored, ``kernels`` many substeps of a world and back, ``engine`` and ``tape`` run
worlds, forward and with derivatives, ``native`` holds inner loops in C++.
"""
