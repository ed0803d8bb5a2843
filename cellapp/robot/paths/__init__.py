"""Paths: compute from poses with speeds a joint path along which the true SMR stays within a tolerance.

Mathematics only: ``cell.targets.path_file`` reads paths, ``cell.exports.joint_paths`` writes what is computed here.
"""
