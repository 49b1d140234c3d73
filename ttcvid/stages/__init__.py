"""The stages of the analysis as pure functions: what is remembered is passed in and returned."""
