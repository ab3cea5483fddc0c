"""Designs as they would go to hardware: several robots, their sensors, and payloads; see `__main__`."""
