"""Deterministic simulation of whole campaigns: the real engine, run file and gate, everything else behind doubles.

A campaign is one seed: it draws faults of arms, tracker, air sensor, disk and program, and what a person does, all on
simulated time. ``campaign`` runs one, ``oracle`` judges what is left, ``trial`` runs many.
"""
