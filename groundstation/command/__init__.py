"""Authority: proposals, confirmations, commands and their verification; requests to vehicles.

All but ``mavsdk_adapter`` is pure: values in, values out.
"""
