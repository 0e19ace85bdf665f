"""What is wrong where a model does not fit: remedies tried on the data and on the rig, ranked by what they explain."""
