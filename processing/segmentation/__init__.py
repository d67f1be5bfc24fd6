"""Stick and slip: where each begins and ends, and the smoother that knows them."""
