"""What every FlowBotHD node shares: parameters, conversions, liveness, diagnostics, start-up."""
