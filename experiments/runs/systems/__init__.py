"""Systems by name: ours, classes of other people, and programs that a YAML file describes."""
