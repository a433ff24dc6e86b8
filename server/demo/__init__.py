"""A simulated fleet that uploads over real HTTP, for a first look and for end-to-end tests."""
