"""Networks that predict flow, and the diffusion and sampling around them."""
