"""Work in stages that run beside each other: reading, device work, writing; results in the order of the items."""
