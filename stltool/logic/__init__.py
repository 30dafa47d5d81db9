"""What a formula is and means: text → Formula, its semantics, its fragment."""
