"""Co-design of flexible optical systems: structure, mirror and controller optimized as one."""
