"""The rig as a drawing: network → tree → plain geometry → strokes → SVG, PNG or PDF."""
