"""Derivatives of whole simulations by reverse mode: what each runner keeps, and how it goes
back."""
