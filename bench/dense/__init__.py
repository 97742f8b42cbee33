"""Maps and points: speed against peers, accuracy against the oracle."""
