"""Folders of meshes that nobody made for this project: are they measured right, and how fast the first time?"""
