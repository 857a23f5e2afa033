"""JUDGE and IDENTIFY: trajectory error of bags, parameter estimates."""
