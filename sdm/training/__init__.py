"""What all trainers share: schedules, checkpoints, budgets."""
