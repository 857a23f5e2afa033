"""Campaigns: plan, drive and identify until the parameters are known."""
