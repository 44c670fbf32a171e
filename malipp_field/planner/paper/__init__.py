"""The paper's own methods, as references: Seq-LIPP, the pairwise LNS, and the literal model."""
