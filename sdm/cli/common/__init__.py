"""Parts that several commands share: inputs, targets, jobs, progress, errors."""
