"""Certificates: bounds no design can pass, and designs that come close to them."""
