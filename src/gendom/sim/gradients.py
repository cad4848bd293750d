"""Derivatives with respect to all inputs of a simulation."""

from dataclasses import dataclass

from gendom.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Gradients:
    """Derivatives of a loss with respect to all inputs of a simulation.

    Not differentiated: the times at which grippers open and close, the substep's length, and
    whether a section touches the table, an obstacle or the body itself, sticks or slides, and poses
    and sizes of obstacles.
    """

    E: Array
    """[W] by Young's modulus [1/Pa]."""
    nu: Array
    """[W] by Poisson's ratio."""
    density: Array
    """[W] by density [m^3/kg]."""
    stiffness: Array
    """[W, N] by the ratio of each particle's or point's E to its material's E."""
    damping: Array
    """[W] by the material's damping [1/s]."""
    velocity_damping: Array
    """[W] by the rate at which velocities decay [s]."""
    air_density: Array
    """[W] by the density of the air [m^3/kg]."""
    friction: Array
    """[W] by the table's coefficient of friction."""
    self_friction: Array
    """[W] by the coefficient of friction at self-contact; 0 without it."""
    gravity: Array
    """[W, 3] by gravity [s^2/m]."""
    positions: Array
    """[W, N, 3] by the initial positions, the rest shape unchanged [1/m]."""
    velocities: Array
    """[W, N, 3] by the initial velocities [s/m]."""
    gripper_positions: Array
    """[W, G, K, 3] by the grippers' positions at their knots [1/m]; shorter paths repeat their
    last knot, whose derivatives stand at the first of the repeats."""
    gripper_rotations: Array
    """[W, G, K, 3] by a rotation of the grippers at their knots, in world axes [1/rad]; 0 for
    grippers without orientations."""
    gripper_radius: Array
    """[W, G] by the radius of the grippers [1/m]."""
    thickness: Array | None = None
    """[W] by the thickness of a cloth or the diameter of a rope, the initial positions unchanged
    [1/m]. MPM: None."""
    obstacle_friction: Array | None = None
    """[W, O] by the obstacles' coefficients of friction. MPM: None."""
    membrane: Array | None = None
    """[W] by the modulus in a cloth's plane [1/Pa]; None if no material has its own, and 0 for
    those that have not."""
    warp: Array | None = None
    """[W] by a shell's bending stiffness along its first side, over an isotropic one's; None for
    other bodies."""
    weft: Array | None = None
    """[W] the same along its second side."""
    shear: Array | None = None
    """[W] the same of its in-plane shear stiffness."""
