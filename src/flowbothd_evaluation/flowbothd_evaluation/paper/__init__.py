"""The paper's experiments: trials, tables, figures, report."""
