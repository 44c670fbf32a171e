"""Proven optima: branch and price over whole-robot schedules, and the arc model it is checked against."""
