"""The FlowBotHD network: data, training, sampling."""

from flowbothd_model.predictor import Predictor, load

__all__ = ["Predictor", "load"]
