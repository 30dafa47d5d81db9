"""Other tools' model files: one file a format, each a function from a path to an MDP."""
