"""A material: hemp rope, by a bench of our own (entry point `gendom.materials`)."""


def of(*ends: float, basis: str = "estimate", **source: str) -> dict:
    """Lowest, typical and highest value of a number, and where they are from."""
    low, typical, high = ends
    found = {"low": low, "typical": typical, "high": high, "basis": basis, "how": "by hand"}
    return found | source


HEMP = {
    "kind": "rope",
    "about": "laid hemp",
    "nu": of(0.2, 0.3, 0.4),
    "friction": of(0.2, 0.4, 0.6),
    "E": of(5e5, 1.1e6, 3e6, basis="measured", source="own-2024"),
    "density": of(600.0, 800.0, 1000.0),
    "damping": of(0.002, 0.005, 0.02),
    "diameter": of(0.004, 0.008, 0.02),
}
SOURCE = {"text": "Our own bench, 2024", "says": "hemp of 8 mm: 1.1 MPa"}
MATERIALS = {"sources": {"own-2024": SOURCE}, "materials": {"hemp-rope": HEMP}}
