from .report import Wording, report

__all__ = ["Wording", "report"]
