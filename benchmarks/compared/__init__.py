"""Laws compared, and campaigns of designs, over the workspaces of robots, by the product's own commands."""
