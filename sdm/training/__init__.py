"""Parts that all trainers share: settings, schedules, budgets, checkpoints, weight averages, precision, curves."""
