"""Files of signed distance maps, one format each."""
