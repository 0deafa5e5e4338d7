"""The run folder: the formats of its files, each with its writer and reader in one module; draws nothing.

May import `core`, `logs` and `evaluation`; neither `viz` nor what runs a method.
"""
