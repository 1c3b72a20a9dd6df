"""Campaigns: thousands of short episodes over a grid of parameters, on this machine or on a cluster."""
