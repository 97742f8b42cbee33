"""Parts that studies of trained networks share: near twins and splits, learning rates by validation, intervals."""
