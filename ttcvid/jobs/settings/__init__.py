"""Options and configuration: where each value comes from."""
