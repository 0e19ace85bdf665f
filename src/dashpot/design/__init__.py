"""The next test: what a planned test would tell, and the test that tells most."""
