"""The team under way: custody ledger, gates, and replanning from the state as it is."""

from malipp_field.control.coordinator import Coordinator, Outcome, Planner
from malipp_field.control.ledger import CustodyLedger

__all__ = ["Coordinator", "CustodyLedger", "Outcome", "Planner"]
