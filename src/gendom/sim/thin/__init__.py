"""Engine for thin bodies: ropes as rods, cloths as shells."""
