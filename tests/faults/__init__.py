"""Long-running tests that try to break the service; `make test-faults` gives them their full time."""
