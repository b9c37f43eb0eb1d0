"""Faults drawn in pairs by seed, each pair on a drawn rig, judged by the plant's truth alone."""
