"""One HTML file about a recording: the lift, the estimate, the action.

Everything is inside the file: it opens without a network, prints, and can be sent by mail.
`motion` and `estimate` make sections of what they are given, and `content` puts them in order.
"""
