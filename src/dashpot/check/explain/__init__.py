"""What may be otherwise than the rig file says: effects, and the engine that weighs them by evidence."""
