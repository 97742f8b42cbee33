"""Primitives that CPU and GPU do differently: warp lanes, atomics, vector loads, shared memory, work queues."""
