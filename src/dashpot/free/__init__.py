"""What data show without a rig: frequency responses, and the modes in them."""
