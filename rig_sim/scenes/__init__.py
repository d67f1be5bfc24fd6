"""Scenes: TOML files that name which terms exist.

The folder is not named ``scene``: importing a module binds its name in its package, which would replace the function
`rig_sim.scene`.  So no module directly inside the four packages has the name of a public function.
"""
