"""A field, its patient and a probe to press with, in a page of the browser.

What is shown is computed without a browser (`ttus_opt.viewer.state`) and drawn by viser
(`ttus_opt.viewer.page`), which is imported when a page is opened.
"""
