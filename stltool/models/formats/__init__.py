"""Other tools' model files: one module per format, each with a function from a path to an MDP."""
