"""The shell's face to people: state for the page, a stream of its changes, actions back.

Rule: nothing here decides anything about vehicles. It shows what the engines said and
hands an operator's action on; the desk, the gate and the guard answer.
"""
