"""Surfaces as VTK, ParaView and PyVista keep them."""
