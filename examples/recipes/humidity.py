"""An unknown of estimates: how a rope's humidity changes its modulus (`gendom.unknowns`)."""

from dataclasses import replace

from gendom.materials.unknowns import Unknown


def of_object(item, value):
    """What it does to the object that policies act on."""
    return replace(item, material=replace(item.material, E=value * item.material.E))


def wetted(inputs, value):
    """What it does to what a lift is replayed with."""
    inputs.E_over_rho *= value


HUMIDITY = Unknown(
    name="humidity",
    symbol="h",
    unit="1",
    meaning="E over that of the dry rope",
    log=True,
    low=0.5,
    high=2.0,
    mean=1.0,
    sd=0.05,
    step=0.02,
    widest=0.1,
    material=True,
    kinds=("rope",),
    on_replay=wetted,
    on_object=of_object,
)
