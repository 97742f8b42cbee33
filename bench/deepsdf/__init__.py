"""DeepSDF: accuracy, recipes, peers."""
