"""What computes a cell (training, tests), and where: processes of this machine, Ray, Slurm."""
