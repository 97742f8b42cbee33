"""Plugin of pytest (`make test-bounds`): kernels check every index of an array, and end the process if one is out.

Kernels are compiled without optimisation, into a cache of their own, so that the quick tests take about an hour.
"""

import warp as wp

wp.config.mode = "debug"
# Else each launch keeps a pointer to its own stack in a static variable of its module, which the checks of one thread
# read while another thread's launch changes it.
wp.config.enable_tiles_in_stack_memory = False
