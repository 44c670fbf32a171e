"""Ruin and recreate: good plans quickly, for teams of any size; no proofs."""
