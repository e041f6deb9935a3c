"""The room as a 3D scene: meshes, robot shapes, poses and their interpolation."""
