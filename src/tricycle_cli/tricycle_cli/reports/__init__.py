"""Tables, figures and HTML pages of plans, drives and identifications."""
