"""Helpers that several tests share: the oracle, meshes that break mesh code, cases on disk."""
