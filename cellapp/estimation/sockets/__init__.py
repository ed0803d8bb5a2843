"""Ball in a socket: readings of a fixed but unknown point, which all rows of one name share."""

from cellapp.estimation.sockets.contacts import Contacts, gauge_errors, in_sockets, measured_positions, placed

__all__ = ["Contacts", "gauge_errors", "in_sockets", "measured_positions", "placed"]
