"""What data show without a rig: frequency responses, and the modes in them."""

MOST_MODES = 40  # that are looked for, unless another number is asked for
