"""What method M6 reaches: every figure about it in the docs, printed again."""
