"""Parts that several commands share: inputs, output files, jobs, progress, error sentences."""
