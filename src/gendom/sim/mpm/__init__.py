"""The material point method: an engine behind ``gendom.sim.Simulator``.

Read ``step`` first: the algorithm. ``elasticity``, ``transfer``, ``boundary`` and ``grid`` are its
stages, ``types`` the arrays they work on, ``model`` the worlds that are simulated, ``runners`` the
ways to run them (a thread or a block of threads for each world, or stages over all), ``adjoint``
their reverse passes, ``native`` the inner loops in C++.
"""
