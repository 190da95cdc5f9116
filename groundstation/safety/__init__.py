"""Gate (plans), grants (authority) and guard (last before any radio). Pure: no clock, no input or output."""
