"""Progress and files of fits, whatever is fitted."""
