"""One HTML file about a recording: the lift, the estimate, the action.

Everything is inside the file: it opens without a network, prints, and can be sent by mail.
`summary` reads an estimate's record. `lift`, `estimate`, `posterior`, `search` and `action` make
sections of what they are given, and `content` puts them in order.
"""
