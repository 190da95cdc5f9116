"""From messages to evidence: clocks, poses, angles, impulse responses, link windows.

Rule: a sample either joins a window or is counted under a name that says why not.
"""
