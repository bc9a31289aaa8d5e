"""What a diagnosis, a fit or a fleet leaves on disk: numbers as JSON, the model, figures and one page."""

from scpjax.report.diagnosis import write_diagnosis
from scpjax.report.fits import fit_json, write_fit, write_fleet
from scpjax.report.pieces import command_line, model_extra

__all__ = ["command_line", "fit_json", "model_extra", "write_diagnosis", "write_fit", "write_fleet"]
