"""An interactive viewer: what is shown (`scenes`), recordings and demonstrations (`models`), and
the page in a browser (`server`, which alone needs viser)."""
