"""The FlowBotHD network: data, training, sampling."""
