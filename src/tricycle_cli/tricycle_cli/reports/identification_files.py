"""Names of the files of an identification, known before what draws some of them is imported."""

FIGURES = "trajectories", "residuals", "lack", "profiles"
DRIVE_BY_DRIVE = "identification.json", "vehicle.yaml"
"""What `tricycle identify --drive-by-drive` writes."""
FILES = (*DRIVE_BY_DRIVE, "report.html", *(f"{name}.png" for name in FIGURES))
"""What `save_identification` may write."""
