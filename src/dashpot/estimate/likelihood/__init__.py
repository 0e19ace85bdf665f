"""Maximum likelihood in the channels."""
