"""The pytest plugin: a simulated rig as a fixture, see docs/hil-tests.md. Nothing is loaded for tests without one."""
