"""Laws compared over the workspaces of robots, by the product."""
