"""Built-in arms: a URDF each, with a YAML of the limits and effects that a URDF cannot hold."""
