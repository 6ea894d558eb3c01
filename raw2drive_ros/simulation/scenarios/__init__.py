"""Scenario types, one module per ability; every module is loaded by `scenario.load_scenarios`."""
